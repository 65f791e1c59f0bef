"""Reference results inside FMUs: computing, storing, replaying and drawing them."""
