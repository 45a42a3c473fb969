"""From images to a run: preprocess, run, slam, demo."""
