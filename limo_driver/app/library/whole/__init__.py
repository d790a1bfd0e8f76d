"""The whole of limo as one piece, proven: plan, move, serve, relearn, diagnose, export."""
