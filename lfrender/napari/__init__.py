"""The plugin for napari (`pip install 'lfrender[napari]'`): readers, sample data, and widgets, by
`napari.yaml`.
"""
