"""The geometry of a scan from the scan itself: every plane through two focal spots is seen in both images (epipolar consistency)."""
