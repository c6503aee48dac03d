KPL/FK

Frame of the Mars Global Surveyor's structure, to which its attitude (CK) refers.

\begindata
FRAME_MGS_SPACECRAFT     = -94000
FRAME_-94000_NAME        = 'MGS_SPACECRAFT'
FRAME_-94000_CLASS       = 3
FRAME_-94000_CLASS_ID    = -94000
FRAME_-94000_CENTER      = -94
CK_-94000_SCLK           = -94
CK_-94000_SPK            = -94
\begintext
