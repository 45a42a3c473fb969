"""Frame in, pose out: start, loss, relocalisation, export of a track."""
