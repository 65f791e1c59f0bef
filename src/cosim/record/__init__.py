"""Files of recorded signals: the records that runs write, and those that measuring tools write."""
