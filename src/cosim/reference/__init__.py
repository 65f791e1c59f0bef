"""Reference results inside FMUs: made, stored, replayed, drawn."""
