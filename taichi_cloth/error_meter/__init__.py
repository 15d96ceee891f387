"""The error of what is on screen: the last second of a run, made again at a finer step."""
