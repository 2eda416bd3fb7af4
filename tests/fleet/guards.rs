//! Each guard of the protocol is needed: without it, the simulation finds a history that violates an invariant.

use crate::database::Guard;
use crate::support::first_failure;
use crate::witness::Invariant;

/// How many histories the search for a violation may take.
const HISTORIES: u64 = 50_000;

/// Asserts that the simulation notices the lack of a guard by a violation of `invariant`.
fn is_noticed(missing: Guard, invariant: Invariant) {
    let failed = first_failure(0..HISTORIES, Some(missing)).expect("a history that violates an invariant");
    assert_eq!(failed.violation.invariant, invariant, "{failed}");
    assert!(first_failure(failed.plan.seed..=failed.plan.seed, None).is_none(), "the guard is what is missing");
}

macro_rules! guards {
    ($($name:ident: $guard:ident => $invariant:ident,)*) => {
        $(#[test]
        fn $name() {
            is_noticed(Guard::$guard, Invariant::$invariant);
        })*
    };
}

guards! {
    two_workers_get_one_job_unless_a_claim_is_atomic: ClaimIsAtomic => LeasesAreExclusive,
    an_attempt_is_not_counted_unless_a_claim_raises_it: ClaimRaisesTheAttempt => RetriesFollowThePolicy,
    a_retry_comes_too_early_unless_a_claim_waits_for_it: ClaimWaitsUntilDue => RetriesFollowThePolicy,
    one_tenant_delays_another_unless_claims_take_turns: ClaimTakesTurns => TenantsAreServedFairly,
    a_tenant_takes_every_slot_unless_claims_keep_its_maximum: ClaimKeepsTheMaximum => TenantsAreServedFairly,
    a_stale_heartbeat_extends_the_next_lease_unless_it_is_fenced: HeartbeatIsFenced => NoStaleWriteLands,
    a_working_worker_loses_its_job_unless_heartbeats_extend_the_lease: HeartbeatExtendsTheLease => LeasesAreExclusive,
    a_stale_completion_lands_unless_it_is_fenced: CompletionIsFenced => NoStaleWriteLands,
    a_stale_write_of_the_same_attempt_lands_unless_the_token_is_compared: FenceHasTheToken => NoStaleWriteLands,
    a_result_is_deleted_unless_a_repeated_completion_is_recognized: RepeatIsRecognized => NothingAcceptedIsLost,
    a_stale_failure_lands_unless_it_is_fenced: FailureIsFenced => NoStaleWriteLands,
    a_stale_release_lands_unless_it_is_fenced: ReleaseIsFenced => NoStaleWriteLands,
    a_result_is_deleted_at_a_shutdown_unless_a_release_recognizes_an_earlier_end:
        ReleaseRecognizesAnEarlierEnd => NothingAcceptedIsLost,
    a_leased_job_is_requeued_unless_the_lease_is_checked: RequeueChecksTheLease => LeasesAreExclusive,
    a_job_kills_workers_forever_unless_its_crashes_are_counted: RequeueCountsTheCrash => RetriesFollowThePolicy,
    a_canceled_job_ends_again_unless_its_lease_is_revoked: CancellationRevokesTheLease => EachJobEndsOnce,
    an_end_is_not_announced_unless_its_transaction_writes_the_message:
        MessageIsWrittenWithTheEnd => EveryEndIsAnnouncedOnce,
    two_dispatchers_send_one_message_unless_a_delivery_is_leased: DeliveryIsLeased => LeasesAreExclusive,
    a_delivered_message_is_sent_again_unless_settling_is_fenced: SettlementIsFenced => EveryEndIsAnnouncedOnce,
    an_accepted_job_is_lost_unless_its_submission_waits_for_the_disk: SubmissionWaitsForTheDisk => NothingAcceptedIsLost,
    an_input_is_deleted_unless_it_is_kept_while_its_submission_is_unknown:
        UnknownSubmissionKeepsItsFiles => NothingAcceptedIsLost,
    a_repeated_request_makes_two_jobs_unless_its_key_is_recorded: KeyIsRecordedWithTheJob => OneRequestMakesOneJob,
}
