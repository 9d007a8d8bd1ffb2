/* 2^n as a product of two entries */
static const @real@ @name@_two_to[8] = { @powers:1@ };
static const @real@ @name@_two_to_8[8] = { @powers:8@ };
