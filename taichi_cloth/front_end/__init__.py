"""Taichi's front end, which reads kernels, mended: it reads faster, and writes less."""
