"""Tables and pictures of docs/accuracy.md."""
