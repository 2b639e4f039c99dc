"""The whole list of faults as a campaign (`make faults`), and which tests hold which row."""
