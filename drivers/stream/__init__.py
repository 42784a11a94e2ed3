"""Serial sensors that send unasked, one on a port: framed binary streams and lines of text."""
