"""The Contract Net Protocol without I/O: state machine, ledger, retransmission, reputation."""
