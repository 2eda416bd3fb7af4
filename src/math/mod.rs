//! Predicates, boxes, and the tree over obvhs.
