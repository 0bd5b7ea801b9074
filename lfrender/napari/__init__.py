"""The plugin for napari (`pip install '.[napari]'`): readers and widgets."""
