//! The subprocess tier: finding Blender, its script, its deadline.
