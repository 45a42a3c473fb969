"""The public face: what ``import maslam`` offers. Import it from ``maslam``; where a name stands in here may change."""

import logging

# Quiet unless the program that imports this says where its log goes.
logging.getLogger("maslam").addHandler(logging.NullHandler())
