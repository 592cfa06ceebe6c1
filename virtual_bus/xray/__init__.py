"""The emulated X-ray side: source, panel and the objects between them. Projections are analytic, without voxels."""
