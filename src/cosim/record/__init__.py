"""Files of recorded signals: records that runs write, and records that measuring tools write."""
