"""Operation 3: offer, order, deliver, check and hold copies of maps (thesis sections 3.7, 3.9.3)."""
