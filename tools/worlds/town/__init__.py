"""A town: streets, houses, cars, terrain, and the routes through it."""
