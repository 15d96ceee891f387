"""The command ``taichi-cloth compare``: two recordings of one scene side by side."""
