"""`explain`: what a scene uses, what is compiled for it, and what each feature costs."""
