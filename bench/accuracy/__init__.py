"""What makes docs/accuracy.md."""
