"""From the control loop's ring to Zenoh, MCAP and the report; loses data before it delays control."""
