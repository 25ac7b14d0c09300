"""The three ROS 2 nodes and the player, thin shells around the stages; only here ROS is used."""
