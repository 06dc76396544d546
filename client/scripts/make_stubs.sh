#!/bin/sh
# Writes the message stubs of src/hullcast/_pb from proto/. Development only:
#   pip install grpcio-tools==1.76.0 && client/scripts/make_stubs.sh
# 1.76 is the newest whose output still imports on protobuf 6.31.
set -eu
root=$(cd "$(dirname "$0")/../.." && pwd)
out=$root/client/src/hullcast/_pb
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m grpc_tools.protoc -I "$root/proto" \
    --python_out="$work" --pyi_out="$work" "$root"/proto/hullcast/v1/*.proto
# The generated modules import only google's, so they can be moved out of the
# folder that the proto path gives them; the descriptors keep the proto path.
for file in "$work"/hullcast/v1/*_pb2.py; do
    sed 's/hullcast\.v1\.\([a-z]*_pb2\)/hullcast._pb.\1/' "$file" > "$out/$(basename "$file")"
done
cp "$work"/hullcast/v1/*_pb2.pyi "$out"
