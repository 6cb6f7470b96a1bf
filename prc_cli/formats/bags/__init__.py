"""ROS 1 and ROS 2 bags and MCAP files, read in the order they were recorded; no ROS and no bag library is needed."""
