// What is loaded when there is something to look at.
export { readColouredMesh } from "./glb";
export { Viewer } from "./viewer";
