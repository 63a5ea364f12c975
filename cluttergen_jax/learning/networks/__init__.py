"""Networks: action distributions, point-cloud and history encoders, actor and critic."""
