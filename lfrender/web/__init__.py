"""Pages for the browser: the report, the viewer, and the demo."""
