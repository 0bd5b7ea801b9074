"""Readers of containers of flats, each by a library of its own: HDF5, Lytro, raw photos, OpenEXR, OME-Zarr."""
