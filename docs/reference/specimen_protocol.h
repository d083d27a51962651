/* The bytes between a hybrid test and a specimen, version 1. See specimen_protocol.md.
 *
 * All numbers are little-endian. A frame is a header, its payload, and a tag of 32 bytes: HMAC-SHA256 of all bytes before it.
 */
#ifndef STRUCTID_SPECIMEN_PROTOCOL_H
#define STRUCTID_SPECIMEN_PROTOCOL_H

#include <stdint.h>

#define SPECIMEN_MAGIC "SIDH"
#define SPECIMEN_VERSION 1
#define SPECIMEN_TAG_BYTES 32
#define SPECIMEN_NONCE_BYTES 16
#define SPECIMEN_LARGEST_PAYLOAD (4u << 20)

/* The words that keys are made with: HMAC-SHA256(secret, words), and HMAC-SHA256(secret, words client_nonce server_nonce). */
#define SPECIMEN_GREETING_WORDS "structid specimen greeting"
#define SPECIMEN_SESSION_WORDS "structid specimen session"

enum specimen_kind {
    SPECIMEN_HELLO = 1,    /* JSON {"nonce": "32 hexadecimal digits", "software": "..."}; number 0 */
    SPECIMEN_WELCOME = 2,  /* JSON {"client_nonce", "nonce", "watchdog", "description"}; number 0 */
    SPECIMEN_MOVE = 3,     /* struct specimen_move_head, then samples x channels float64 [m] */
    SPECIMEN_READING = 4,  /* channels float64 displacements [m], channels float64 forces [N] */
    SPECIMEN_HOLD = 5,     /* UTF-8, why */
    SPECIMEN_HELD = 6,     /* nothing */
    SPECIMEN_CLOSE = 7,    /* nothing */
    SPECIMEN_CLOSED = 8,   /* nothing; the server then ends the connection */
    SPECIMEN_PING = 9,     /* nothing */
    SPECIMEN_PONG = 10,    /* nothing */
    SPECIMEN_REFUSED = 12  /* UTF-8, why; the server then ends the connection, and the specimen holds its position */
};

#pragma pack(push, 1)

struct specimen_header {
    char magic[4];      /* SPECIMEN_MAGIC */
    uint16_t version;   /* SPECIMEN_VERSION */
    uint16_t kind;      /* enum specimen_kind */
    uint64_t sequence;  /* of a request that of the one before plus one, from 1; of an answer that of its request */
    uint32_t length;    /* of the payload, at most SPECIMEN_LARGEST_PAYLOAD */
    uint32_t zero;      /* 0 */
};

struct specimen_move_head {
    uint32_t samples;   /* controller steps of the path, one or more */
    uint32_t channels;  /* as many as the description has */
    uint32_t averaged;  /* over how many of the last steps the reading is averaged, from 1 to samples */
};

#pragma pack(pop)

#endif
