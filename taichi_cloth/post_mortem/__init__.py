"""What is found out about a run when it ends: why it failed, and with which setting it survives."""
