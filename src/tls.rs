//! The TLS provider of the process's clients.

/// Sets ring as the process's TLS provider, unless a provider is already set. Call this before creating a client that uses the default
/// provider.
pub fn use_ring() {
    // An error means that a provider is already set.
    let _ = rustls::crypto::ring::default_provider().install_default();
}
