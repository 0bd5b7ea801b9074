"""Live pictures of a camera: sources, the newest frame analysed and drawn, recordings, a page for
browsers.
"""
