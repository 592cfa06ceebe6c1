"""Algebra of Kalman filters, whatever their model: square roots once per sample, measurements that come late."""
