"""Renderers, the coverage of pixels that they share, and the labels of their images.

`painter` is the default, `mesh_renderer` draws with OpenGL, `supersampled` is the slow reference.
"""
