"""limo: driver, simulator and torque estimator for slow, force-sensitive robot arms."""
