"""Maps as few bits: quantised, as differences between versions, Rice coded."""
