"""Live pictures of a camera: sources, session, recordings, and the page."""
