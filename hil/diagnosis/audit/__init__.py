"""Whether controller and sensors are what the machine file says, by what was recorded of them alone."""
