// Bundles the page into dist: one script, one sheet, one page, and the licences of what is in them.

import { cpSync, mkdirSync, readFileSync, writeFileSync } from 'node:fs';
import { build } from 'esbuild';

const out = 'dist';
const LINKS = ['panda_link5/0', 'panda_hand/0'];

/** A file of the repository, as text. */
function read(path) {
  return readFileSync(new URL(path, import.meta.url), 'utf8');
}

/** The robot links that the page offers, out of the scene of the arm. */
const robot = {
  name: 'robot',
  setup(build) {
    build.onResolve({ filter: /^hullcast:robot$/ }, ({ path }) => ({ path, namespace: 'robot' }));
    build.onLoad({ filter: /.*/, namespace: 'robot' }, () => {
      const { hulls } = JSON.parse(read('../examples/scenes/panda.json'));
      const points = LINKS.map((link) => hulls.find(({ name }) => name === link).vertices.flat());
      return { contents: JSON.stringify(points), loader: 'json' };
    });
  },
};

const { metafile } = await build({
  entryPoints: ['src/main.ts'],
  outfile: `${out}/playground.js`,
  bundle: true,
  format: 'esm',
  target: 'es2022',
  minify: true,
  charset: 'utf8',
  legalComments: 'none',
  metafile: true,
  plugins: [robot],
});
mkdirSync(out, { recursive: true });
cpSync('index.html', `${out}/index.html`);
cpSync('playground.css', `${out}/playground.css`);
writeFileSync(`${out}/licences.txt`, licences(Object.keys(metafile.inputs)));

/** The text for what the bundle was made of; a package that is not known here ends the build. */
function licences(inputs) {
  const found = new Set(inputs.map((path) => /node_modules\/((?:@[^/]+\/)?[^/]+)/.exec(path)?.[1]).filter(Boolean));
  const protobuf = read('node_modules/@bufbuild/protobuf/dist/esm/wire/varint.js');
  const known = {
    three: `MIT\n\n${read('node_modules/three/LICENSE')}`,
    '@bufbuild/protobuf':
      'Copyright Buf Technologies, Inc.; Apache-2.0, whose text is at the end. Its reader and writer of varints:\n\n' +
      protobuf.split('\n').filter((line) => line.startsWith('//')).map((line) => line.slice(3)).join('\n'),
    '@connectrpc/connect': 'Copyright The Connect Authors; Apache-2.0, whose text is at the end.',
    '@connectrpc/connect-web': 'Copyright The Connect Authors; Apache-2.0, whose text is at the end.',
  };
  const sections = [...found].sort().map((name) => {
    if (!(name in known)) throw new Error(`${name} is in the bundle: give its licence in build.mjs`);
    const { version } = JSON.parse(read(`node_modules/${name}/package.json`));
    return `${name} ${version}\n${known[name].trim()}\n`;
  });
  const line = `\n${'-'.repeat(78)}\n\n`;
  return [
    'hullcast: MIT OR Apache-2.0, as the rest of the project. Its playground contains:\n',
    ...sections,
    'Robot links: convex hulls of collision meshes of the Panda arm (franka_description),\n' +
      'Copyright Franka Emika GmbH; Apache-2.0.\n',
    read('../examples/scenes/LICENSES/panda-Apache-2.0.txt'),
  ].join(line);
}
