"""A scene in motion on the device."""
