"""FRI, the Fast Robot Interface of the KUKA LBR: driver, codec and simulated controller."""
