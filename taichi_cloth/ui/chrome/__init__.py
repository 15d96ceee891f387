"""Parts around the world in a window: tool bar, status strip, key list, banner, and the columns
beside it. Each part draws itself as a `tiles.Panel`, the same pixels in every view.
"""
