"""The control nodes of the KUKA arm. Rooms, each above the one before: `model`, `limits`, `loop`, then `gui`, `ros`."""
