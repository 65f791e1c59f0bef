"""From a checked System to rows: instances, program, loop, run."""
