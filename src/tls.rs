//! The cryptography of the process's clients.

/// Makes ring the cryptography of every TLS client of this process, if none was chosen before. Clients that leave the choice to the
/// process can be made after it.
pub fn use_ring() {
    // An error says that there is one already.
    let _ = rustls::crypto::ring::default_provider().install_default();
}
