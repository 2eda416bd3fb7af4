//! Checks for every container of the program, with Compose or Kubernetes.

use std::collections::BTreeMap;

use super::image::Image;
use super::program::settings;

/// A container of the program, as Compose or Kubernetes runs it.
pub struct Container {
    pub name: String,
    pub command: Vec<String>,
    /// Without the variables of the image.
    pub variables: BTreeMap<String, String>,
    /// Paths of writable mounts.
    pub mounts: Vec<String>,
    pub memory_mib: u64,
    /// Seconds from SIGTERM to SIGKILL.
    pub grace: f64,
}

impl Container {
    /// Checks mounts, grace period and memory, and returns the settings.
    pub fn check(&self) -> BTreeMap<String, String> {
        let name = &self.name;
        let image = Image::read();
        let mut variables = image.variables();
        variables.extend(self.variables.clone());
        let settings = settings(&self.command, &variables);
        let number = |variable: &str| settings.get(variable).map(|value| value.parse::<f64>().expect("a number"));
        for folder in [settings["MESHMEND_DATA_DIR"].as_str(), "/tmp"] {
            assert!(self.mounts.iter().any(|mount| mount == folder), "{name}: {folder} is not writable");
        }
        if let Some(grace) = number("MESHMEND_SHUTDOWN_GRACE_S") {
            assert!(
                self.grace >= grace + 5.0,
                "{name}: is killed after {} s, and may need {grace} s to stop",
                self.grace
            );
        }
        if settings.get("MESHMEND_NO_WORKERS").is_none_or(|value| value == "false")
            && let (Some(jobs), Some(job)) = (number("MESHMEND_WORKERS"), number("MESHMEND_JOB_MEMORY_MIB"))
        {
            let blenders =
                number("MESHMEND_BLENDER_TOTAL_MEMORY_MIB").expect("set: half of the machine's is not of the limit");
            let most = jobs * job + blenders;
            assert!(most < self.memory_mib as f64, "{name}: {most} MiB of {}", self.memory_mib);
        }
        settings
    }
}

/// Parses a size such as 512m or 8Gi to MiB.
pub fn mebibytes(size: &str) -> u64 {
    let (number, unit) = size.split_at(size.find(|c: char| !c.is_ascii_digit()).expect("a unit"));
    let number: u64 = number.parse().expect("a number");
    match unit {
        "m" | "Mi" => number,
        "g" | "Gi" => number << 10,
        unit => panic!("{size}: no such unit as {unit}"),
    }
}

/// Parses a time such as 40s to seconds.
pub fn seconds(time: &str) -> f64 {
    time.strip_suffix('s').unwrap_or(time).parse().expect("seconds")
}
