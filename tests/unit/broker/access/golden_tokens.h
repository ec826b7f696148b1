// SPDX-License-Identifier: MIT
#pragma once

#include <cstdint>

/// Tokens that PyJWT 2.6 signed, with the public halves of the keys, which were thrown away: the same claims in four
/// algorithms, good until the year 2100.
///   {"sub":"camera-1","aud":"eigencast","iat":1700000000,"exp":4102444800,"eigencast":{"pub":["lab/**"],"sub":["**"]}}
namespace eigencast::broker::testing {

inline constexpr std::int64_t kNow = 1'800'000'000;
inline constexpr const char* kSecret = "a secret of more than thirty-two bytes";
inline constexpr const char* kGoldenSecret = "0123456789abcdef0123456789abcdef-golden";
inline constexpr const char* kGoldenRs256Key =
    "-----BEGIN PUBLIC KEY-----\n"
    "MIIBIjANBgkqhkiG9w0BAQEFAAOCAQ8AMIIBCgKCAQEArh5fkGNDl+h1hUo5zNel\n"
    "nwNdflfUCE9nYhAMaRUf8hv2SoHYJH7yU8D01hZWJ7tHC/NlEsKi9BlmJFEkDQI3\n"
    "yAwGIYle6InEP1sYsOPQfV7RuKGGp5sXu/W483eobuT98Y0+Mu0wzEvuK1G1s9sb\n"
    "cwaOu8l9mr4ktdh0EWfZLiyJwvjrZ607c7ZpbyPrQUEFQraVJkOW9Obn3SZmFUH2\n"
    "/F85hgV1sAegkA/+7a+K4oqBIJsHufrIC/dIjoXz1UG1iM3fyC6m9tjDOwxWQ3PC\n"
    "X5hEyX1KFDNZf+bZa0Tq2F1IYLZj1ZO7zrw9hA66sGJY+xtWYr/WevTct54pGbE2\n"
    "4QIDAQAB\n"
    "-----END PUBLIC KEY-----\n";
inline constexpr const char* kGoldenRs256Token =
    "eyJhbGciOiJSUzI1NiIsImtpZCI6ImdvbGRlbiIsInR5cCI6IkpXVCJ9.eyJzdWIiOiJjYW1lcmEtMSIsImF1ZCI6ImVpZ2VuY2F"
    "zdCIsImlhdCI6MTcwMDAwMDAwMCwiZXhwIjo0MTAyNDQ0ODAwLCJlaWdlbmNhc3QiOnsicHViIjpbImxhYi8qKiJdLCJzdWIiOls"
    "iKioiXX19.bGbxP8JUnNZ_Fg1eHm_QimxgHl-9GYQzamIA6rbHkrGUQFjXsQczmEKs_XpJDQxH94YraoAJdswMVTdYsVUgK5nd23"
    "kXBpGNWXCPcrHf76Qs2Q_v4c3UteUduH1zELgl1-IQ6KglxTnzwatPHljEU1Nezf2-jYKpSiobbbJ67jaFyrdx738nw7YGBMDWFd"
    "hB0ze8Sc-ke_FsVINsDaHnWEs5K4OK2G265ix2XAJiEeL2DQhDT0x5v2mYOIW1-ClFd2fGC1uvCL9tDvc53VVCbuHYkTWEVdt57X"
    "PEhWQ1ZDucMgHF_9DcJTV_BFbj79ndw4QyjCtIxYND0th2s_BX-g";
inline constexpr const char* kGoldenEs256Key =
    "-----BEGIN PUBLIC KEY-----\n"
    "MFkwEwYHKoZIzj0CAQYIKoZIzj0DAQcDQgAE0CmjdAV5FsPfqyHnuKEaZuEjdEkV\n"
    "SV+E1SEm9RNeH3ec0Hbj41NxZ49ASGX9rqjM/Q1SciYfxMOWZYKHNOeumA==\n"
    "-----END PUBLIC KEY-----\n";
inline constexpr const char* kGoldenEs256Token =
    "eyJhbGciOiJFUzI1NiIsImtpZCI6ImdvbGRlbiIsInR5cCI6IkpXVCJ9.eyJzdWIiOiJjYW1lcmEtMSIsImF1ZCI6ImVpZ2VuY2F"
    "zdCIsImlhdCI6MTcwMDAwMDAwMCwiZXhwIjo0MTAyNDQ0ODAwLCJlaWdlbmNhc3QiOnsicHViIjpbImxhYi8qKiJdLCJzdWIiOls"
    "iKioiXX19.hzFy20huaYDZXOibK6wJrY8Mt83c1O4-x0Kgk-nOyyno02ZwgsfDoCXrSbLjBUh3d5lM3KjDo3gGxitMJSel_A";
inline constexpr const char* kGoldenEdDsaKey =
    "-----BEGIN PUBLIC KEY-----\n"
    "MCowBQYDK2VwAyEAzrMqCrTx/MV2b8x6vtgU5O8Wyo0mdcPR0wHRdmj5xYM=\n"
    "-----END PUBLIC KEY-----\n";
inline constexpr const char* kGoldenEdDsaToken =
    "eyJhbGciOiJFZERTQSIsImtpZCI6ImdvbGRlbiIsInR5cCI6IkpXVCJ9.eyJzdWIiOiJjYW1lcmEtMSIsImF1ZCI6ImVpZ2VuY2F"
    "zdCIsImlhdCI6MTcwMDAwMDAwMCwiZXhwIjo0MTAyNDQ0ODAwLCJlaWdlbmNhc3QiOnsicHViIjpbImxhYi8qKiJdLCJzdWIiOls"
    "iKioiXX19.oxxo4UxlJpFJLCrQxMZpl36uoQyzaQbbOj_M9x3lTl2fNBVF7ZM3cCncvcfc2EIakiV6OUAyhMOX-kvWqSGfDQ";
inline constexpr const char* kGoldenHs256Token =
    "eyJhbGciOiJIUzI1NiIsImtpZCI6ImdvbGRlbiIsInR5cCI6IkpXVCJ9.eyJzdWIiOiJjYW1lcmEtMSIsImF1ZCI6ImVpZ2VuY2F"
    "zdCIsImlhdCI6MTcwMDAwMDAwMCwiZXhwIjo0MTAyNDQ0ODAwLCJlaWdlbmNhc3QiOnsicHViIjpbImxhYi8qKiJdLCJzdWIiOls"
    "iKioiXX19.KDor2_zFyu7eJWZZyrzd5WE9tdI0bBPRfmNWeXEjowk";

}  // namespace eigencast::broker::testing
