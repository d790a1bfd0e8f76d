"""What a client sends: its commands judged, its datagrams counted, and what it was built for."""
