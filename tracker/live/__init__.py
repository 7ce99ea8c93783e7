"""Live: from a camera, a file played in real time or a stream to bending angles as they are filmed."""
