import { createContext } from "preact";
import { useContext } from "preact/hooks";
import { type Language, type Speech, speech } from "../words/words";

/** What the widget says and the page does not: its readers are a shop's customers, who know of no service behind it. */
const en = {
  upload: "Upload a 3D model",
  dropHere: "Drop your 3D model here",
  letGo: "Let go to upload it",
  orChoose: "or choose it from your device",
  choose: "Choose a file",
  oneAtATime: "One model at a time, please: drop a single file.",
  another: "Upload another model",
  result: "Result",
  proven: (list: string) => `Checked on the result itself: ${list}.`,
  advice: {
    token_missing: "This upload is not set up yet. Please tell the shop.",
    token_refused: "The shop gave no permission to upload. Reload the page or sign in again, then try once more.",
    bad_attribute: "This upload is not set up correctly. Please tell the shop.",
    origin_not_allowed: "The shop's permission is for another address than this page's. Please tell the shop.",
    unauthorized: "The permission to upload has run out. Reload the page and try again.",
    forbidden: "The shop's permission does not allow this. Please tell the shop.",
    unreachable: "The upload service does not answer. Look whether you are online, then try again.",
    store_unreachable: "The file could not be sent. Try again; if it stays, tell the shop.",
    unsupported_model: "This is no 3D model that can be read. Export it as STL, 3MF or OBJ.",
    crashed: "Something went wrong on our side. Try once more; if it stays, tell the shop.",
    worker_lost: "Something went wrong on our side. Try once more; if it stays, tell the shop.",
    internal: "Something went wrong on our side. Try once more; if it stays, tell the shop.",
    deadline_exceeded: "The model took too long to repair. Send it with fewer faces.",
    unavailable: "The upload service is busy. Try again in a moment.",
    unrepairable: "The model could not be repaired.",
    not_printable: "The model can't be printed, and could not be repaired so that it can.",
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
  oneAtATime: "Bitte ein Modell nach dem anderen: nur eine Datei ablegen.",
  another: "Anderes Modell hochladen",
  result: "Ergebnis",
  proven: (list) => `Am Ergebnis selbst geprüft: ${list}.`,
  advice: {
    token_missing: "Dieses Hochladen ist noch nicht eingerichtet. Bitte dem Shop Bescheid geben.",
    token_refused: "Der Shop hat das Hochladen nicht erlaubt. Seite neu laden oder neu anmelden, dann noch einmal versuchen.",
    bad_attribute: "Dieses Hochladen ist nicht richtig eingerichtet. Bitte dem Shop Bescheid geben.",
    origin_not_allowed: "Die Erlaubnis des Shops gilt für eine andere Adresse als diese Seite. Bitte dem Shop Bescheid geben.",
    unauthorized: "Die Erlaubnis zum Hochladen ist abgelaufen. Seite neu laden und noch einmal versuchen.",
    forbidden: "Die Erlaubnis des Shops reicht hierfür nicht. Bitte dem Shop Bescheid geben.",
    unreachable: "Der Dienst zum Hochladen antwortet nicht. Verbindung prüfen, dann noch einmal versuchen.",
    store_unreachable: "Die Datei konnte nicht gesendet werden. Noch einmal versuchen; wenn es bleibt, dem Shop Bescheid geben.",
    unsupported_model: "Das ist kein lesbares 3D-Modell. Als STL, 3MF oder OBJ exportieren.",
    crashed: "Auf unserer Seite ist etwas schiefgegangen. Noch einmal versuchen; bleibt es so, dem Shop Bescheid geben.",
    worker_lost: "Auf unserer Seite ist etwas schiefgegangen. Noch einmal versuchen; bleibt es so, dem Shop Bescheid geben.",
    internal: "Auf unserer Seite ist etwas schiefgegangen. Noch einmal versuchen; bleibt es so, dem Shop Bescheid geben.",
    deadline_exceeded: "Die Reparatur hat zu lange gedauert. Mit weniger Dreiecken schicken.",
    unavailable: "Der Dienst ist ausgelastet. Gleich noch einmal versuchen.",
    unrepairable: "Das Modell konnte nicht repariert werden.",
    not_printable: "Das Modell ist nicht druckbar und ließ sich nicht druckbar machen.",
    canceled: "Abgebrochen.",
  },
};

export const TEXTS: Record<Language, Texts> = { en, de };

/** What the widget says within a view. */
export const TextsOf = createContext<Texts>(TEXTS.en);

export function useTexts(): Texts {
  return useContext(TextsOf);
}

/** What is spoken in the widget: the page's words, with advice for customers where the page's is for whoever runs the service. */
export function customerSpeech(language: Language): Speech {
  const { words, figures } = speech(language);
  const { advice, proven } = TEXTS[language];
  return { words: { ...words, proven, advice: { ...words.advice, ...advice } }, figures };
}
