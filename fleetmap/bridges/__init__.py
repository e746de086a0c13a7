"""Where robot people already are: ROS 2 in and out, with ROS or without, and recordings. Needs ``fleetmap[ros]``."""
