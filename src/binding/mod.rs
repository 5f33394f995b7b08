//! (Scan, Proxy, Capture) → Binding: space, landmarks, labels, placement, handles.

pub mod landmarks;
