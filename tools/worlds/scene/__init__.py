"""Meshes, textures and objects: what a world is made of."""
