"""Files of logs as tables: text, Parquet, arrays, bags of ROS 2, LeRobotDatasets."""
