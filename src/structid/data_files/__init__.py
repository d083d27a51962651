"""Files of measurements: records of agencies, and files of loggers, laboratories and programs."""
