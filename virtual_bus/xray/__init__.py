"""The emulated X-ray side: source, panel and what stands between them. Projections are analytic: no voxels."""
