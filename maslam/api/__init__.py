"""The public face: what ``import maslam`` offers. Import it from ``maslam``; where a name stands in here may change."""
