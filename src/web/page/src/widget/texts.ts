import { createContext } from "preact";
import { useContext } from "preact/hooks";
import { type Language, type Locale, localeOf } from "../words/locale";

/** Texts that only the widget uses. A shop's customers read them and do not know about the service behind the widget. */
const en = {
  upload: "Upload a 3D model",
  dropHere: "Drop your 3D model here",
  letGo: "Release to upload",
  orChoose: "or choose it from your device",
  choose: "Choose a file",
  oneAtATime: "Please drop a single file: one model at a time.",
  another: "Upload another model",
  result: "Result",
  proven: (list: string) => `Checked on the result itself: ${list}.`,
  advice: {
    token_missing: "The upload is not set up yet. Please contact the shop.",
    token_refused: "The shop did not permit the upload. Reload the page or sign in again, then try again.",
    bad_attribute: "The upload is not set up correctly. Please contact the shop.",
    origin_not_allowed: "The shop's permission is not valid for the address of this page. Please contact the shop.",
    unauthorized: "The permission to upload has expired. Reload the page and try again.",
    forbidden: "The shop's permission does not allow this. Please contact the shop.",
    unreachable: "The upload service does not answer. Check that you are online, then try again.",
    store_unreachable: "The file could not be sent. Try again. If the error persists, please contact the shop.",
    unsupported_model: "This file is not a readable 3D model. Export it as STL, 3MF or OBJ.",
    crashed: "Something went wrong on our side. Try again. If the error persists, please contact the shop.",
    worker_lost: "Something went wrong on our side. Try again. If the error persists, please contact the shop.",
    internal: "Something went wrong on our side. Try again. If the error persists, please contact the shop.",
    deadline_exceeded: "The repair took too long. Send the model with fewer faces.",
    unavailable: "The upload service is busy. Try again in a moment.",
    unrepairable: "The model could not be repaired.",
    not_printable: "The model is not printable, and the repair could not make it printable.",
    not_print_ready: "The model breaks rules of the printing process. The table lists them.",
    canceled: "Cancelled.",
  } as Record<string, string>,
};

export type Texts = typeof en;

const de: Texts = {
  upload: "3D-Modell hochladen",
  dropHere: "3D-Modell hier ablegen",
  letGo: "Loslassen zum Hochladen",
  orChoose: "oder vom Gerät auswählen",
  choose: "Datei auswählen",
  oneAtATime: "Bitte legen Sie nur eine Datei ab: ein Modell nach dem anderen.",
  another: "Anderes Modell hochladen",
  result: "Ergebnis",
  proven: (list) => `Am Ergebnis selbst geprüft: ${list}.`,
  advice: {
    token_missing: "Das Hochladen ist noch nicht eingerichtet. Bitte wenden Sie sich an den Shop.",
    token_refused: "Der Shop hat das Hochladen nicht erlaubt. Laden Sie die Seite neu oder melden Sie sich neu an, und versuchen Sie es erneut.",
    bad_attribute: "Das Hochladen ist nicht richtig eingerichtet. Bitte wenden Sie sich an den Shop.",
    origin_not_allowed: "Die Erlaubnis des Shops gilt nicht für die Adresse dieser Seite. Bitte wenden Sie sich an den Shop.",
    unauthorized: "Die Erlaubnis zum Hochladen ist abgelaufen. Laden Sie die Seite neu und versuchen Sie es erneut.",
    forbidden: "Die Erlaubnis des Shops reicht hierfür nicht aus. Bitte wenden Sie sich an den Shop.",
    unreachable: "Der Dienst zum Hochladen antwortet nicht. Bitte prüfen Sie Ihre Internetverbindung und versuchen Sie es erneut.",
    store_unreachable: "Die Datei konnte nicht gesendet werden. Bitte versuchen Sie es erneut. Wenn der Fehler bestehen bleibt, wenden Sie sich an den Shop.",
    unsupported_model: "Diese Datei ist kein lesbares 3D-Modell. Bitte exportieren Sie es als STL, 3MF oder OBJ.",
    crashed: "Auf unserer Seite ist etwas schiefgegangen. Bitte versuchen Sie es erneut. Wenn der Fehler bestehen bleibt, wenden Sie sich an den Shop.",
    worker_lost: "Auf unserer Seite ist etwas schiefgegangen. Bitte versuchen Sie es erneut. Wenn der Fehler bestehen bleibt, wenden Sie sich an den Shop.",
    internal: "Auf unserer Seite ist etwas schiefgegangen. Bitte versuchen Sie es erneut. Wenn der Fehler bestehen bleibt, wenden Sie sich an den Shop.",
    deadline_exceeded: "Die Reparatur hat zu lange gedauert. Bitte senden Sie das Modell mit weniger Flächen.",
    unavailable: "Der Dienst ist ausgelastet. Bitte versuchen Sie es gleich erneut.",
    unrepairable: "Das Modell konnte nicht repariert werden.",
    not_printable: "Das Modell ist nicht druckbar und ließ sich nicht druckbar machen.",
    not_print_ready: "Das Modell verletzt Regeln des Druckverfahrens. Die Tabelle zeigt, welche.",
    canceled: "Abgebrochen.",
  },
};

export const TEXTS: Record<Language, Texts> = { en, de };

/** The widget's own texts within a view. */
export const TextsOf = createContext<Texts>(TEXTS.en);

export function useTexts(): Texts {
  return useContext(TextsOf);
}

/**
 * The shared texts for the widget, with advice for customers in place of advice for the operator. Where there is such advice, the detail is
 * for the shop: it names options, settings or the state of the service.
 */
export function customerLocale(language: Language): Locale {
  const { words, figures } = localeOf(language);
  const { advice, proven } = TEXTS[language];
  return { words: { ...words, proven, advice: { ...words.advice, ...advice } }, figures, withoutDetail: Object.keys(advice) };
}
