"""The network: joint states, estimates and events on Zenoh and ROS 2, and who may."""
