//! Printing with a named process: the processes' rules, the measures that the rules need, and whether a model meets
//! the rules.
//!
//! [`Profile`] holds a process's limits. [`assess`](readiness::assess) measures a printable solid against each of them.

pub mod profile;
