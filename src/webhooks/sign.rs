use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;
use uuid::Uuid;

use crate::jobs::{Secrets, SigningSecret};

/// What secrets begin with, so that programs that search for leaked secrets find them.
const PREFIX: &str = "whsec_";

/// Random numbers, passed in so that tests can hold them.
pub trait Random: Send + Sync {
    /// 128 bits in the form of a random UUID: 122 of them are random.
    fn bits(&self) -> u128;
}

/// The operating system's random numbers.
#[derive(Debug, Clone, Copy, Default)]
pub struct SystemRandom;

impl Random for SystemRandom {
    fn bits(&self) -> u128 {
        Uuid::new_v4().as_u128()
    }
}

/// A new secret of 32 bytes, 244 bits of them random.
#[must_use]
pub fn new_secret(random: &dyn Random) -> SigningSecret {
    let bytes = [random.bits().to_be_bytes(), random.bits().to_be_bytes()].concat();
    SigningSecret::new(format!("{PREFIX}{}", STANDARD.encode(bytes)))
}

/// The header `webhook-signature` of a message sent at `timestamp`, in seconds since the Unix epoch: one signature for each secret
/// that is in force then.
pub(super) fn signatures(secrets: &Secrets, message: &str, timestamp: i64, payload: &str) -> String {
    let previous = secrets.previous.as_ref().filter(|(_, until)| until.unix_timestamp() > timestamp);
    let in_force = std::iter::once(&secrets.current).chain(previous.map(|(secret, _)| secret));
    let signatures: Vec<String> = in_force.map(|secret| signature(secret, message, timestamp, payload)).collect();
    signatures.join(" ")
}

fn signature(secret: &SigningSecret, message: &str, timestamp: i64, payload: &str) -> String {
    let text = secret.reveal();
    // Only secrets of `new_secret` are stored, so this is the key; anything else would give signatures that nobody can verify.
    let key = STANDARD.decode(text.strip_prefix(PREFIX).unwrap_or(text)).unwrap_or_default();
    #[expect(clippy::expect_used, reason = "HMAC takes keys of any length (RFC 2104)")]
    let mut mac = Hmac::<Sha256>::new_from_slice(&key).expect("a key of any length");
    mac.update(format!("{message}.{timestamp}.{payload}").as_bytes());
    format!("v1,{}", STANDARD.encode(mac.finalize().into_bytes()))
}

#[cfg(test)]
mod tests {
    use standardwebhooks::Webhook;
    use time::{Duration, OffsetDateTime};

    use super::*;
    use crate::jobs::{Clock, SystemClock};

    #[test]
    fn the_specifications_own_example_is_signed_as_it_says() {
        let secret = SigningSecret::new("whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw".into());
        let signed = signature(&secret, "msg_p5jXN8AQM9LWM0D4loKWxJek", 1_614_265_330, "{\"test\": 2432232314}");
        assert_eq!(signed, "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE=");
    }

    #[test]
    fn both_secrets_sign_while_the_old_one_is_in_force_and_only_the_new_one_afterwards() {
        let now = SystemClock.now_ms() / 1000;
        let (old, new) = (new_secret(&SystemRandom), new_secret(&SystemRandom));
        assert_ne!(old, new);
        assert!(!format!("{new:?}").contains(&new.reveal()[6..]));
        let until = OffsetDateTime::from_unix_timestamp(now).expect("a time") + Duration::seconds(60);
        let secrets = Secrets { current: new.clone(), previous: Some((old.clone(), until)) };
        let verifies = |secret: &SigningSecret, at: i64| {
            let mut headers = axum::http::HeaderMap::new();
            let signed = signatures(&secrets, "msg_1", at, "{}");
            for (name, value) in
                [("webhook-id", "msg_1"), ("webhook-timestamp", &at.to_string()), ("webhook-signature", &signed)]
            {
                headers.insert(name, value.parse().expect("a header"));
            }
            Webhook::new(secret.reveal()).expect("a secret").verify(b"{}", &headers).is_ok()
        };
        assert!(verifies(&old, now) && verifies(&new, now));
        assert!(!verifies(&new_secret(&SystemRandom), now));
        assert!(!verifies(&old, now + 60) && verifies(&new, now + 60));
    }
}
