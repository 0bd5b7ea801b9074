"""Pictures from viewpoints off the middle of the main lens: lens by lens, and many views of one flat."""
