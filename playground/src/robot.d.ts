/** Vertices of some of the arm's links, three numbers each; build.mjs makes it. */
declare module 'hullcast:robot' {
  const links: [number[], number[]];
  export default links;
}
