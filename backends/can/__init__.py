"""Arms of drives on a CAN bus: CiA 402 over CANopen, and Damiao's MIT mode."""
