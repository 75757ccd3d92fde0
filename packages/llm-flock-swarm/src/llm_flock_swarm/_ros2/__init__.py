"""ROS 2 without ROS: the team as ordinary nodes over rmw_zenoh's wire format, and records as bags."""
