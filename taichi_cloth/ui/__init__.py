"""Everything a person looks at: windows, the camera, the mouse's tools, films."""
