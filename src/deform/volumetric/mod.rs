//! The volumetric deformer of Stoll et al. 2007.
