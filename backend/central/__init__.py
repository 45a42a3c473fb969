"""The certified central solver, the gtsam adapter, costs."""
