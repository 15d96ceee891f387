"""The post-mortem of a run: why it failed, and with which setting it survives."""
