//! GLB
