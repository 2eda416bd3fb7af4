use std::sync::OnceLock;

use super::{BlenderConfig, BlenderRemesher};
use crate::repair::{Context, RemeshError, RemeshRequest, Remeshed, Remesher, RemesherInfo};

/// [`BlenderRemesher`] that looks for Blender when it is first needed: asking a program for its version takes longer
/// than most repairs, and most repairs don't need it.
#[derive(Debug)]
pub struct OnDemandBlender {
    config: BlenderConfig,
    found: OnceLock<Result<BlenderRemesher, String>>,
}

impl OnDemandBlender {
    /// Looks for nothing yet.
    #[must_use]
    pub fn new(config: BlenderConfig) -> Self {
        Self { config, found: OnceLock::new() }
    }

    fn found(&self) -> Result<&BlenderRemesher, &str> {
        let found = self.found.get_or_init(|| BlenderRemesher::find(self.config.clone()).map_err(|e| e.to_string()));
        found.as_ref().map_err(String::as_str)
    }
}

impl Remesher for OnDemandBlender {
    fn info(&self) -> Result<&RemesherInfo, &str> {
        self.found()?.info()
    }

    fn runs(&self) -> u32 {
        self.found.get().and_then(|found| found.as_ref().ok()).map_or(0, Remesher::runs)
    }

    fn remesh(&self, request: &RemeshRequest<'_>, context: &Context<'_>) -> Result<Remeshed, RemeshError> {
        match self.found() {
            Ok(blender) => blender.remesh(request, context),
            Err(reason) => Err(RemeshError::Start { program: "Blender".to_owned(), reason: reason.to_owned() }),
        }
    }
}
