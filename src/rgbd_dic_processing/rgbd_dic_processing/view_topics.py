"""What viewer_node gives: topic -> type; and what compensation_node gives it alone."""

VIEW_TYPES = {
    "view/image_rect": "sensor_msgs/msg/Image",
    "view/camera_info": "sensor_msgs/msg/CameraInfo",
    "view/regions": "visualization_msgs/msg/ImageMarker",
    "view/displacement": "visualization_msgs/msg/ImageMarker",
    "view/subsets": "sensor_msgs/msg/PointCloud2",
    "view/scene": "visualization_msgs/msg/MarkerArray",
    "view/opening": "rgbd_dic_msgs/msg/OpeningBand",
    "view/cloud": "sensor_msgs/msg/PointCloud2",
}

PREVIEWED_FIELD = "_previewed_field"  # hidden: no recorder takes it for a part of the measurement
