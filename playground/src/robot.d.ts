/** Vertices of two links of the arm, three numbers each; made by build.mjs. */
declare module 'hullcast:robot' {
  const links: [number[], number[]];
  export default links;
}
