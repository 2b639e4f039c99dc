"""Long runs whose memory and gaps must stay flat (`make soak`)."""
