from rclpy.qos import QoSProfile

class TopicEndpointInfo:
    node_name: str
    qos_profile: QoSProfile
