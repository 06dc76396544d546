import * as grpc from "@grpc/grpc-js";
import { loadSync } from "@grpc/proto-loader";

const files = ["hullcast/v1/hulls.proto", "hullcast/v1/contacts.proto"];
const loaded = loadSync(files, { includeDirs: ["../../proto"], defaults: true });
const { HullService, ContactService } = (grpc.loadPackageDefinition(loaded) as any).hullcast.v1;
const target = process.argv[2], plain = grpc.credentials.createInsecure();
const hulls = new HullService(target, plain), contacts = new ContactService(target, plain);

const cube = [0, 0, 0, 0, 0, 1, 0, 1, 0, 0, 1, 1, 1, 0, 0, 1, 0, 1, 1, 1, 0, 1, 1, 1];
hulls.registerHulls({ hulls: [{ vertices: cube }] }, (error: unknown, registered: any) => {
  if (error) throw error;
  const scene = {
    hullIds: [registered.results[0].hull.id],
    bodyHulls: [0, 0], // both bodies are the cube
    positions: [0, 0, 0, 0.2, 0, 0.99],
    rotations: [0, 0, 0, 1, 0, 0, 0, 1],
  };
  contacts.queryContacts({ ...scene, pairs: [0, 1], margin: 0.01 }, (error: unknown, m: any) => {
    if (error) throw error;
    const [alpha, separation] = [m.alphas[0].toFixed(2), m.separations[0].toFixed(2)];
    console.log(`alpha ${alpha}, separation ${separation}, ${m.pointCounts[0]} points`);
    hulls.close(), contacts.close();
  });
});
