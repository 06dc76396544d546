"""Readers of mesh files, one module per format.

Each module has a function `read(data)`, which returns vertices (n, 3) and triangles (m, 3) in the
file's own coordinates, or raises `Unreadable`. A feature that changes the geometry is read as its
format defines it, or refused with a message that names it. Colours, normals and texture coordinates
are ignored.
"""
