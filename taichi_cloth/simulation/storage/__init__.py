"""The state on the device: where everything is put there, and how it comes back."""
