"""The plugin for napari (`pip install 'lfrender[napari]'`): readers and widgets."""
