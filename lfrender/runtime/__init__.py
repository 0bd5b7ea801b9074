"""What all rooms share: words of options, types, texts of errors."""
