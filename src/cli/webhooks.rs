use std::time::Duration;

use clap::Args;
use meshmend::webhooks::{DispatcherConfig, Poster, PosterError, Reach, Schedule};

/// Whom the service may tell of jobs, and how often it tries.
#[derive(Debug, Args)]
pub struct WebhookArgs {
    /// Leave the delivery of webhooks to other processes that serve.
    #[arg(long, env = "MESHMEND_NO_WEBHOOKS")]
    no_webhooks: bool,
    /// Let webhooks go to this machine and to private networks, by http too, at any port. Only where every tenant is trusted.
    #[arg(long, env = "MESHMEND_WEBHOOK_ALLOW_PRIVATE")]
    webhook_allow_private: bool,
    /// Seconds that a receiver has to answer a webhook.
    #[arg(long, env = "MESHMEND_WEBHOOK_TIMEOUT_S", default_value_t = 15.0)]
    webhook_timeout_s: f64,
    /// Seconds to wait before each further try to deliver a webhook, with commas between; after the last it is given up.
    #[arg(long, env = "MESHMEND_WEBHOOK_RETRY_S", default_value = "5,300,1800,7200,18000,36000,50400,72000,86400")]
    webhook_retry_s: Schedule,
}

impl WebhookArgs {
    /// Which addresses may be named and reached.
    pub fn reach(&self) -> Reach {
        if self.webhook_allow_private { Reach::Anything } else { Reach::Public }
    }

    /// How to deliver; none where that is left to others.
    pub fn delivery(&self, poll: Duration) -> Result<Option<(Poster, DispatcherConfig)>, PosterError> {
        if self.no_webhooks {
            return Ok(None);
        }
        let timeout = super::service::seconds(self.webhook_timeout_s);
        // Time enough to note how it went.
        let lease = 2 * timeout + Duration::from_secs(1);
        let config = DispatcherConfig { lease, schedule: self.webhook_retry_s.clone(), poll };
        Ok(Some((Poster::new(self.reach(), timeout)?, config)))
    }
}
