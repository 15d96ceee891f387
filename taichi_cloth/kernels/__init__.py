"""Device code: fields and Taichi kernels. Knows no scene, no file and no window."""
