use std::str::FromStr;
use std::time::Duration;

/// How long to wait before each further try to deliver a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Schedule(Vec<Duration>);

/// A text that is no schedule.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a schedule is 1 to 50 numbers of seconds with commas between, each at most 30 days")]
pub struct ScheduleError;

/// Most waits, and the longest, in seconds.
const MOST: usize = 50;
const LONGEST_S: f64 = 30.0 * 24.0 * 3600.0;

impl Schedule {
    /// The wait after try number `tries` (1 for the first) failed; none when it was the last. Up to a fifth is added, so that messages
    /// which failed together don't come back together. `random` is any 64 random bits.
    #[must_use]
    pub fn wait(&self, tries: u32, random: u64) -> Option<Duration> {
        let wait = *self.0.get(usize::try_from(tries).ok()?.checked_sub(1)?)?;
        let fifth = u64::try_from(wait.as_millis() / 5).unwrap_or(u64::MAX);
        Some(wait + Duration::from_millis(if fifth == 0 { 0 } else { random % fifth }))
    }
}

impl FromStr for Schedule {
    type Err = ScheduleError;

    fn from_str(text: &str) -> Result<Self, ScheduleError> {
        let seconds =
            |text: &str| text.trim().parse::<f64>().ok().filter(|seconds| (0.0..=LONGEST_S).contains(seconds));
        let waits = text.split(',').map(|text| seconds(text).map(Duration::from_secs_f64));
        let waits = waits.collect::<Option<Vec<_>>>().ok_or(ScheduleError)?;
        if waits.len() <= MOST { Ok(Self(waits)) } else { Err(ScheduleError) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_are_as_given_with_up_to_a_fifth_more_and_end_with_the_last() {
        let schedule: Schedule = "5, 300,0.5".parse().expect("a schedule");
        for (tries, low, high) in [(1, 5000, 6000), (2, 300_000, 360_000), (3, 500, 600)] {
            for random in [0, 1, u64::MAX / 3, u64::MAX] {
                let wait = schedule.wait(tries, random).expect("a wait").as_millis();
                assert!((low..high).contains(&wait), "try {tries}: {wait} ms");
            }
        }
        assert_ne!(schedule.wait(2, 1), schedule.wait(2, 59_999));
        assert_eq!((schedule.wait(0, 0), schedule.wait(4, 0), schedule.wait(u32::MAX, 0)), (None, None, None));
        let many = vec!["1"; 51].join(",");
        for wrong in ["", "1,", "a", "-1", "NaN", "inf", "1e9", &many] {
            assert_eq!(wrong.parse::<Schedule>(), Err(ScheduleError), "{wrong}");
        }
    }
}
