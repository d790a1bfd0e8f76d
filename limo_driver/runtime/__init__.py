"""What nobody has to know: compilation, processes, declarations, plug-ins, files."""
