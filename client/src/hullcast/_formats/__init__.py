"""Readers of mesh files, a module per format.

Each has `read(data)`, which returns vertices (n, 3) and triangles (m, 3) in the file's own
coordinates, or raises `Unreadable`. A feature that changes the geometry is read as its
format defines it, or refused by name; colours, normals and texture coordinates are ignored.
"""
