import { useLayoutEffect, useMemo, useRef, useState } from "preact/hooks";
import { claimsOf } from "../report/verdict";
import { dropped } from "../state/files";
import type { Unit } from "../units";
import { Icon } from "../views/icons";
import { ProblemNote } from "../views/problem-note";
import { Stages } from "../views/stages";
import { useStore } from "../views/use-store";
import { type Language, LocaleContext, useWords } from "../words/locale";
import { DropZone, FORMATS } from "./drop-zone";
import { Outcome } from "./outcome";
import type { Session, State } from "./session";
import { TEXTS, TextsOf, customerLocale, useTexts } from "./texts";

interface Props {
  session: Session;
  language: Language;
  unit: Unit;
  accept: string | null;
}

export function Widget({ language, ...props }: Props) {
  return (
    <LocaleContext.Provider value={useMemo(() => customerLocale(language), [language])}>
      <TextsOf.Provider value={TEXTS[language]}>
        <Box lang={language} {...props} />
      </TextsOf.Provider>
    </LocaleContext.Provider>
  );
}

/** The drop zone, the progress, or the result. A model may be dropped on the drop zone and on the result. */
function Box({ session, lang, unit, accept }: Omit<Props, "language"> & { lang: Language }) {
  const texts = useTexts();
  const state = useStore(session.state);
  const box = useRef<HTMLDivElement>(null);
  const [over, setOver] = useState(false);
  const [note, setNote] = useState("");
  const isFree = state.phase === "empty" || state.phase === "ended" || state.phase === "refused";
  const shown = isFree ? state.phase : "busy";
  const take = (files: File[]): void => {
    setNote(files.length === 1 ? "" : texts.oneAtATime);
    if (files.length === 1) session.take(files[0]!);
  };
  const drag = (event: DragEvent): void => {
    if (!event.dataTransfer?.types.includes("Files")) return;
    event.preventDefault();
    const isLeaving = event.type === "dragleave" && !box.current?.contains(event.relatedTarget as Node | null);
    if (isFree) setOver(!isLeaving);
    if (event.type !== "drop") return;
    setOver(false);
    if (isFree) void dropped(event.dataTransfer, FORMATS).then(take);
  };
  // The focused element may have disappeared with its view.
  const hadFocus = box.current?.matches(":focus-within") ?? false;
  useLayoutEffect(() => {
    if (hadFocus && !box.current?.matches(":focus-within")) box.current?.focus();
  }, [shown]);
  return (
    <div
      class="box"
      part="box"
      ref={box}
      lang={lang}
      role="group"
      aria-label={texts.upload}
      tabIndex={-1}
      onDragEnter={drag}
      onDragOver={drag}
      onDragLeave={drag}
      onDrop={drag}
    >
      {shown === "empty" && <DropZone accept={accept} over={over} take={take} />}
      {shown === "busy" && <Progress session={session} state={state} />}
      {shown === "ended" && state.job && <Outcome key={state.job.id} session={session} own={state.job} job={state.chosen ?? state.job} can={state.can} unit={unit} choice={state.choice} />}
      {shown === "refused" && <Refused session={session} state={state} />}
      {over && shown !== "empty" && <p class="letgo">{texts.letGo}</p>}
      {note && (
        <p class="note" role="alert">
          {note}
        </p>
      )}
      <p class="hidden" role="status">
        <Announcement state={state} />
      </p>
    </div>
  );
}

/** Text for screen readers when the job ends. `Stages` announces the stages, and the note announces problems. */
function Announcement({ state: { phase, job } }: { state: State }) {
  const { words } = useWords();
  if (phase !== "ended" || !job) return null;
  return <>{words.outcomes[claimsOf(job).title]}</>;
}

/** Progress of the file, with buttons to pause or cancel. */
function Progress({ session, state }: { session: Session; state: State }) {
  const { words, figures } = useWords();
  const { phase, name } = state;
  return (
    <section class="under" part="progress">
      <h2>{name}</h2>
      <Stages item={{ ...state, phase: phase === "empty" ? "waiting" : phase }} />
      <p class="aside">{phase === "paused" ? `${words.states.paused}. ${words.pauseNote}` : "\u00a0"}</p>
      <div class="actions">
        {phase === "uploading" && (
          <button type="button" class="plain" part="button" onClick={() => session.pause()}>
            <Icon name="pause" /> {words.pause}
          </button>
        )}
        {phase === "paused" && (
          <button type="button" class="primary" part="button primary" onClick={() => session.resume()}>
            <Icon name="play" /> {words.resume} <span class="size">{figures.bytes(state.bytes)}</span>
          </button>
        )}
        <button type="button" class="plain" part="button" onClick={() => void session.cancel()}>
          {words.cancel}
        </button>
      </div>
    </section>
  );
}

/** Why the file was not accepted, with a button to try again. */
function Refused({ session, state }: { session: Session; state: State }) {
  const texts = useTexts();
  const { words } = useWords();
  return (
    <section class="under" part="problem">
      <h2>{state.name}</h2>
      {state.problem && <ProblemNote problem={state.problem} />}
      <div class="actions">
        <button type="button" class="primary" part="button primary" onClick={() => session.resume()}>
          {words.retry}
        </button>
        <button type="button" class="plain" part="button" onClick={() => session.reset()}>
          {texts.another}
        </button>
      </div>
    </section>
  );
}
