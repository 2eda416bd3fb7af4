use std::path::{Path, PathBuf};

use landlock::{
    ABI, Access, AccessFs, AccessNet, BitFlags, LandlockStatus, Ruleset, RulesetAttr, RulesetCreatedAttr, RulesetError,
    RulesetStatus, Scope, make_bitflags, path_beneath_rules,
};

/// The newest rights that this program knows of; an older kernel gives those that it has.
const NEWEST: ABI = ABI::V9;

/// Where programs and their libraries are, read and run.
const PROGRAMS: [&str; 10] =
    ["/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/libx32", "/nix/store", "/gnu/store", "/etc/alternatives"];

/// What programs read: how to find libraries, fonts and the local time; what machine this is and how much memory it has; random
/// numbers. Other processes show their command lines in `/proc`, and nothing more.
const SYSTEM: [&str; 13] = [
    "/etc/fonts",
    "/etc/ld.so.cache",
    "/etc/ld.so.conf",
    "/etc/ld.so.conf.d",
    "/etc/ld.so.preload",
    "/etc/localtime",
    "/etc/nsswitch.conf",
    "/etc/passwd",
    "/proc",
    "/sys/devices/system",
    "/sys/fs/cgroup",
    "/dev/random",
    "/dev/urandom",
];

/// Devices without content.
const EMPTY: [&str; 2] = ["/dev/null", "/dev/zero"];

/// What may be done in the folder that can be written: no programs, devices, sockets, pipes or links, which could lead the
/// worker elsewhere when it comes for the results.
const WRITABLE: BitFlags<AccessFs> = make_bitflags!(AccessFs::{ReadFile | ReadDir | WriteFile | Truncate | MakeReg | MakeDir | RemoveFile | RemoveDir | Refer});

/// Leaves this process and what it starts only the files that programs need, and `folder` to write; no TCP and no signals to
/// others. Gives the name of what is in force.
pub(super) fn restrict(readable: &[PathBuf], folder: &Path) -> Result<String, String> {
    let status = try_restrict(readable, folder).map_err(|error| format!("Landlock failed ({error})"))?;
    match status.landlock {
        LandlockStatus::NotEnabled => Err("Landlock is not enabled; add it to the kernel's parameter lsm=".to_owned()),
        LandlockStatus::NotImplemented => {
            Err("the kernel has no Landlock (it is part of Linux 5.13), or the container's \
                                               seccomp profile refuses it"
                .to_owned())
        }
        LandlockStatus::Available { .. } if status.ruleset == RulesetStatus::NotEnforced => {
            Err("the kernel did not put Landlock in force".to_owned())
        }
        LandlockStatus::Available { effective_abi, .. } => Ok(format!("landlock {}", effective_abi as i32)),
    }
}

fn try_restrict(readable: &[PathBuf], folder: &Path) -> Result<landlock::RestrictionStatus, RulesetError> {
    let read = AccessFs::ReadFile | AccessFs::ReadDir;
    Ruleset::default()
        .handle_access(AccessFs::from_all(NEWEST))?
        .handle_access(AccessNet::from_all(NEWEST))?
        .scope(Scope::from_all(NEWEST))?
        .create()?
        .add_rules(path_beneath_rules(PROGRAMS, read | AccessFs::Execute))?
        .add_rules(path_beneath_rules(readable, read | AccessFs::Execute))?
        .add_rules(path_beneath_rules(python_settings(), read))?
        .add_rules(path_beneath_rules(SYSTEM, read))?
        .add_rules(path_beneath_rules(EMPTY, AccessFs::ReadFile | AccessFs::WriteFile))?
        .add_rules(path_beneath_rules([folder], WRITABLE))?
        .restrict_self()
}

/// Where Debian keeps parts of the library of its Pythons.
fn python_settings() -> impl Iterator<Item = PathBuf> {
    let entries = std::fs::read_dir("/etc").into_iter().flatten().flatten();
    entries.filter(|entry| entry.file_name().to_string_lossy().starts_with("python")).map(|entry| entry.path())
}
