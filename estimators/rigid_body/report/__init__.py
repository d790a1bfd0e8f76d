"""Report of an identification: its page, its tables, and every base parameter by name."""
