"""Shared by all commands: errors, options, progress, parallel jobs, files, plot style."""
