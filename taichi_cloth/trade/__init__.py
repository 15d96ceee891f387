"""The measured trade: errors beside costs, the largest stable step, the setting to choose."""
