"""What the findings allow to say, and the reasons for it as data."""
