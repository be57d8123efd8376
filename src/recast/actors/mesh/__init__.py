"""Vehicles from textured mesh files: GLB and OBJ to flat Gaussians."""

from recast.actors.mesh.generator import MESH_SUFFIXES, MeshGenerator, files_of_mesh, read_triangles

__all__ = ["MESH_SUFFIXES", "MeshGenerator", "files_of_mesh", "read_triangles"]
