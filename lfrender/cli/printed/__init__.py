"""What commands print: figures, sentences, and the objects of `--json`."""
