"""Pages that are made from the code: nothing on them is written a second time. ``docs.build`` calls them."""
