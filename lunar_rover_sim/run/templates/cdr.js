// Messages of ROS 2 by the definitions that the server sends: CDR bytes to objects.
'use strict';

const SIZES = {bool: 1, byte: 1, char: 1, int8: 1, uint8: 1, int16: 2, uint16: 2, int32: 4,
  uint32: 4, float32: 4, int64: 8, uint64: 8, float64: 8};

// Returns type name -> fields of it, from the text of a ros2msg schema.
function parseSchema(name, text) {
  const types = {};
  let current = name.replace('/msg/', '/');
  types[current] = [];
  for (const whole of text.split('\n')) {
    const line = whole.replace(/#.*/, '').trim();
    if (line.startsWith('MSG:')) {
      current = line.slice(4).trim().replace('/msg/', '/');
      types[current] = [];
    } else if (line && !line.startsWith('=')) {
      const [kind, field, ...rest] = line.split(/\s+/);
      if (field.includes('=') || (rest[0] ?? '').startsWith('=')) continue;   // a constant
      const [, type, array, count] = kind.match(/^([\w/]+)(?:<=\d+)?(\[(?:<=)?(\d*)\])?$/);
      types[current].push({field, type, isArray: array !== undefined,
        count: array && !array.includes('<=') && count ? Number(count) : null});
    }
  }
  return {types, root: name.replace('/msg/', '/')};
}

class CdrReader {
  constructor(bytes) {
    this.bytes = bytes;
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    this.little = (bytes[1] & 1) === 1;
    this.at = 4;
  }

  align(size) {
    this.at = 4 + Math.ceil((this.at - 4) / size) * size;
  }

  number(type) {
    const size = SIZES[type];
    this.align(size);
    const at = this.at;
    this.at += size;
    switch (type) {
      case 'bool': return this.view.getUint8(at) !== 0;
      case 'int8': return this.view.getInt8(at);
      case 'int16': return this.view.getInt16(at, this.little);
      case 'uint16': return this.view.getUint16(at, this.little);
      case 'int32': return this.view.getInt32(at, this.little);
      case 'uint32': return this.view.getUint32(at, this.little);
      case 'int64': return Number(this.view.getBigInt64(at, this.little));
      case 'uint64': return Number(this.view.getBigUint64(at, this.little));
      case 'float32': return this.view.getFloat32(at, this.little);
      case 'float64': return this.view.getFloat64(at, this.little);
      default: return this.view.getUint8(at);
    }
  }

  string() {
    const length = this.number('uint32');
    const text = new TextDecoder().decode(this.bytes.subarray(this.at, this.at + length - 1));
    this.at += length;
    return text;
  }

  read(schema, type) {
    const result = {};
    for (const one of schema.types[type]) {
      result[one.field] = one.isArray ? this.array(schema, one) : this.value(schema, one.type,
        type);
    }
    return result;
  }

  value(schema, type, inside) {
    if (type in SIZES) return this.number(type);
    if (type === 'string') return this.string();
    // A type without a package is of that of the message around it.
    return this.read(schema, type in schema.types ? type : `${inside.split('/')[0]}/${type}`);
  }

  array(schema, one) {
    const count = one.count ?? this.number('uint32');
    if (SIZES[one.type] === 1) {
      const piece = this.bytes.subarray(this.at, this.at + count);
      this.at += count;
      return one.type === 'int8' ? new Int8Array(piece) : piece;
    }
    return Array.from({length: count}, () => this.value(schema, one.type, schema.root));
  }
}

function decode(schema, bytes) {
  return new CdrReader(bytes).read(schema, schema.root);
}

// geometry_msgs/Twist with a speed ahead [m/s] and a turn to the left [rad/s].
function encodeTwist(ahead, turn) {
  const view = new DataView(new ArrayBuffer(4 + 6 * 8));
  view.setUint8(1, 1);
  view.setFloat64(4, ahead, true);
  view.setFloat64(4 + 5 * 8, turn, true);
  return new Uint8Array(view.buffer);
}
