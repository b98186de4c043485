<#
.SYNOPSIS
Builds the Windows installer of the capture agent, on 64-bit Windows.

.DESCRIPTION
The stages are those of the build under Wine (installer/wine/recipe.py), each in a folder of
its own below build\installer-windows. The Python and the packages are kept as long as they
still fit; everything after them is made again. In dist there are then the installer, its
SHA-256 and the bill of materials.

Runs in Windows PowerShell 5.1 and in PowerShell 7. Ends with exit code 1 and one sentence
if something fails.

.PARAMETER Python
A python.exe to build with, 64-bit and of the one version that the build under Wine has, too
(installer/layout.py). Without it the one that is found.

.PARAMETER MakeNsis
Where makensis.exe is, if it is neither on PATH nor in NSIS's usual folder.

.PARAMETER Clean
Keep nothing of an earlier build.

.EXAMPLE
powershell -ExecutionPolicy Bypass -File installer\build.ps1 -Clean
#>
[CmdletBinding()]
param(
    [string] $Python = '',
    [string] $MakeNsis = '',
    [switch] $Clean
)

Set-StrictMode -Version 3.0
$ErrorActionPreference = 'Stop'
# Exit codes are checked below, with a sentence that says what failed.
$PSNativeCommandUseErrorActionPreference = $false

$Root = Split-Path -Parent $PSScriptRoot
$Work = Join-Path $Root 'build\installer-windows'
$Dist = Join-Path $Root 'dist'
$Lock = Join-Path $Root 'requirements\freeze.txt'
# As in installer/layout.py: what is tested under Wine is what is released.
$PythonVersion = '3.13.2'

function Invoke-Native {
    # Run a program, show what it says, and fail if it does.
    param([string] $Command, [string[]] $Arguments)
    & $Command @Arguments | Out-Host
    if ($LASTEXITCODE -ne 0) {
        throw "'$Command $($Arguments -join ' ')' failed with exit code $LASTEXITCODE; its output is above."
    }
}

function Read-Native {
    # Run a program and return what it prints.
    param([string] $Command, [string[]] $Arguments)
    $output = & $Command @Arguments
    if ($LASTEXITCODE -ne 0) {
        throw "'$Command $($Arguments -join ' ')' failed with exit code $LASTEXITCODE; its output is above."
    }
    return ($output -join "`n").Trim()
}

function Use-Environment {
    # Run a block with these variables, where $null removes one; afterwards they are as before.
    param([hashtable] $Variables, [scriptblock] $Block)
    $before = @{}
    foreach ($name in $Variables.Keys) {
        $before[$name] = [Environment]::GetEnvironmentVariable($name)
    }
    try {
        Set-Environment $Variables
        & $Block
    }
    finally {
        Set-Environment $before
    }
}

function Set-Environment {
    param([hashtable] $Variables)
    foreach ($name in $Variables.Keys) {
        if ($null -ne $Variables[$name]) {
            Set-Item -LiteralPath "Env:$name" -Value $Variables[$name]
        }
        elseif (Test-Path -LiteralPath "Env:$name") {
            Remove-Item -LiteralPath "Env:$name"
        }
    }
}

function Test-Python {
    # Whether a command starts a Python that can build; names prove nothing, see the Store's alias.
    param([hashtable] $Candidate)
    if (-not (Get-Command $Candidate.Command -ErrorAction SilentlyContinue)) {
        return $false
    }
    $options = $Candidate.Options
    $code = "import platform, sys, sysconfig; fits = platform.python_version() == '$PythonVersion'; " +
        "sys.exit(not (fits and sysconfig.get_platform() == 'win-amd64'))"
    # In Windows PowerShell 5.1 any line on stderr would end the script.
    $ErrorActionPreference = 'Continue'
    & $Candidate.Command @options -c $code 2>&1 | Out-Null
    return $LASTEXITCODE -eq 0
}

function Find-Python {
    # A Python to build with, as a command and its first options.
    param([string] $Chosen)
    $candidates = @(@{ Command = 'py'; Options = @('-3') }, @{ Command = 'python'; Options = @() })
    $candidates += @{ Command = 'py'; Options = @("-$($PythonVersion -replace '\.\d+$', '')") }
    if ($Chosen) {
        $candidates = @(@{ Command = $Chosen; Options = @() })
    }
    foreach ($candidate in $candidates) {
        if (Test-Python $candidate) {
            return $candidate
        }
    }
    if ($Chosen) {
        throw "$Chosen is not a 64-bit Python $PythonVersion for Windows; name one that is, or leave -Python out."
    }
    throw "No 64-bit Python $PythonVersion was found; install it from python.org, or name its python.exe with -Python."
}

function Find-MakeNsis {
    param([string] $Chosen)
    $folders = @(${env:ProgramFiles(x86)}, $env:ProgramFiles) | Where-Object { $_ }
    $candidates = @('makensis') + @($folders | ForEach-Object { Join-Path $_ 'NSIS\makensis.exe' })
    if ($Chosen) {
        $candidates = @($Chosen)
    }
    foreach ($candidate in $candidates) {
        $found = Get-Command $candidate -CommandType Application -ErrorAction SilentlyContinue
        if ($found) {
            return @($found)[0].Source
        }
    }
    throw 'makensis was not found; install NSIS 3 (choco install nsis, or nsis.sourceforge.io), or name makensis.exe with -MakeNsis.'
}

function Invoke-Stage {
    # Fill a folder again, unless it holds the fingerprint of what would be put there.
    param([string] $Name, [scriptblock] $Make, [string] $Fingerprint = '')
    $folder = Join-Path $Work $Name
    $stamp = Join-Path $folder '.fingerprint'
    if ($Fingerprint -and (Test-Path -LiteralPath $stamp) -and ([IO.File]::ReadAllText($stamp) -eq $Fingerprint)) {
        Write-Host "${Name}: unchanged"
        return
    }
    $watch = [Diagnostics.Stopwatch]::StartNew()
    if (Test-Path -LiteralPath $folder) {
        Remove-Item -LiteralPath $folder -Recurse -Force
    }
    New-Item -ItemType Directory -Path $folder | Out-Null
    & $Make $folder
    if ($Fingerprint) {
        [IO.File]::WriteAllText($stamp, $Fingerprint)
    }
    Write-Host ('{0}: made in {1:N0} s' -f $Name, $watch.Elapsed.TotalSeconds)
}

function Get-BaseFolder {
    # Where the Python lies that a virtual environment was made of, with its licence.
    param([string] $Environment)
    # Not asked of Python itself: a console's code page may lack letters of the path.
    $lines = [IO.File]::ReadAllLines((Join-Path $Environment 'pyvenv.cfg'))
    $line = @($lines | Where-Object { $_ -match '^home\s*=' })[0]
    return ($line -split '=', 2)[1].Trim()
}

function Install-Lock {
    param([string] $Interpreter, [string] $Folder)
    $hashed = @('--require-hashes', '--only-binary', ':all:', '-r', $Lock)
    Invoke-Native $Interpreter (@('-m', 'pip', 'install', '--quiet', '--target', $Folder) + $hashed)
}

function Install-Product {
    param([string] $Interpreter, [string] $Folder)
    Invoke-Native $Interpreter @('-m', 'pip', 'install', '--quiet', '--no-deps', '--target', $Folder, $Root)
}

function Invoke-Freeze {
    # One folder with the program; it must start, and be of the version that is built.
    param([string] $Interpreter, [string] $Version, [string] $Program, [string] $Folder)
    $variables = @{
        PYTHONPATH      = @((Join-Path $Work 'product'), (Join-Path $Work 'packages')) -join ';'
        PYTHONHASHSEED  = '0'
        # PyInstaller takes libraries that it finds on PATH, such as some other program's runtime.
        PATH            = @("$env:SystemRoot\System32", $env:SystemRoot) -join ';'
        GATEWAY_VERSION = $Version
        GATEWAY_FROZEN  = Join-Path $PSScriptRoot 'frozen.py'
        GATEWAY_ICON    = Join-Path $Work 'pictures\icon.ico'
    }
    $options = @('--noconfirm', '--clean', '--log-level', 'WARN')
    $folders = @('--distpath', $Folder, '--workpath', (Join-Path $Folder 'work'))
    $spec = Join-Path $PSScriptRoot 'biosensor-gateway.spec'
    Use-Environment $variables {
        Invoke-Native $Interpreter (@('-m', 'PyInstaller') + $options + $folders + @($spec))
    }
    $said = Read-Native (Join-Path $Folder "$Program\$Program.exe") @('--version')
    if ($said -ne "$Program $Version") {
        throw "The frozen program says '$said' instead of '$Program $Version'; run again with -Clean."
    }
}

function Invoke-Own {
    # Run a part of the build that is written in Python, with the locked packages.
    param([string] $Interpreter, [string[]] $Arguments)
    Use-Environment @{ PYTHONPATH = Join-Path $Work 'packages' } {
        Invoke-Native $Interpreter (@('-m') + $Arguments)
    }
}

function Complete-Bundle {
    # What is installed: the program in a folder of its own, the pages, licences of all parts
    # and the bill of materials. An archive has no uninstaller, and so another bill.
    param([string] $Interpreter, [string] $Program, [string] $Folder)
    $bundle = Join-Path $Folder $Program
    New-Item -ItemType Directory -Path $bundle | Out-Null
    Copy-Item -LiteralPath (Join-Path $Work "freeze\$Program") -Destination (Join-Path $bundle 'bin') -Recurse
    Copy-Item -LiteralPath (Join-Path $Work 'manual') -Destination (Join-Path $bundle 'docs') -Recurse
    $parts = @(
        '--bundle', (Join-Path $bundle 'bin'),
        '--packages', (Join-Path $Work 'packages'),
        '--python', (Get-BaseFolder (Join-Path $Work 'python')),
        '--product', (Join-Path $Work 'product'),
        '--documents', (Join-Path $Work 'manual'),
        '--below', 'bin'
    )
    $uninstaller = @('--uninstaller', (Join-Path $Work 'uninstaller\uninstall.exe'))
    Invoke-Own $Interpreter (@('installer.bundle') + $parts + $uninstaller + @('--out', $bundle))
    Invoke-Own $Interpreter (@('installer.bundle') + $parts + @('--out', (Join-Path $Folder 'portable')))
}

function New-Portable {
    # The program as an archive, which needs no installer and no administrator.
    param([string] $Interpreter, [string] $Program, [string] $Output)
    $unpacked = Join-Path (Split-Path -Parent $Output) 'unpacked'
    # Its licences and its bill are its own.
    Copy-Item -LiteralPath (Join-Path $Work 'bundle\portable') -Destination $unpacked -Recurse
    foreach ($part in 'bin', 'docs') {
        Copy-Item -LiteralPath (Join-Path $Work "bundle\$Program\$part") -Destination $unpacked -Recurse
    }
    Invoke-Own $Interpreter @('installer.portable', $unpacked, $Output)
    Remove-Item -LiteralPath $unpacked -Recurse -Force
}

function New-Setup {
    # The installer of what the stages before have made; with nothing to install, its uninstaller.
    param([string] $Compiler, [string] $Version, [string] $Output, [string[]] $Bundle = @())
    $folder = Split-Path -Parent $Output
    $definitions = @(
        # The NSIS that its authors publish for Windows has no 64-bit stubs.
        '-DTARGET=x86-unicode',
        "-DVERSION=$Version",
        "-DPICTURES=$(Join-Path $Work 'pictures')",
        '-DCOPY=copy /b',
        "-DUNINSTALLER=$(Join-Path $folder 'uninstall.exe')",
        "-DOUTPUT=$Output"
    ) + $Bundle
    $script = Join-Path $PSScriptRoot 'biosensor-gateway.nsi'
    Invoke-Native $Compiler (@('-V2', '-WX', '-INPUTCHARSET', 'UTF8') + $definitions + @($script))
    if (-not (Test-Path -LiteralPath $Output)) {
        throw "makensis ended well but $Output is not there; see what it said above."
    }
}

function Test-Uninstaller {
    # The bill of materials has the hash of the one that was made alone.
    $made = 'uninstaller', 'package' | ForEach-Object { Get-FileHash -LiteralPath (Join-Path $Work "$_\uninstall.exe") }
    if ($made[0].Hash -ne $made[1].Hash) {
        throw 'The installer has another uninstaller than its bill of materials; run again with -Clean.'
    }
}

function Publish-File {
    # Put a file and its SHA-256 into dist.
    param([string] $File)
    $name = Split-Path -Leaf $File
    $target = Join-Path $Dist $name
    Copy-Item -LiteralPath $File -Destination $target
    $digest = (Get-FileHash -Algorithm SHA256 -LiteralPath $target).Hash.ToLowerInvariant()
    # As sha256sum writes and checks it; Out-File of 5.1 would write UTF-16.
    [IO.File]::WriteAllText("$target.sha256", "$digest  $name`n")
    Write-Host "wrote $target"
}

function Publish-Release {
    # Put into dist what a release consists of, and nothing of an earlier one.
    param([string] $Version, [string] $Program, [string] $SetupName, [string] $PortableName)
    New-Item -ItemType Directory -Path $Dist -Force | Out-Null
    Get-ChildItem -LiteralPath $Dist -File |
        Where-Object { $_.Name -match '(-setup\.exe|-portable\.zip|\.sha256|\.cdx\.json)$' } |
        Remove-Item
    Publish-File (Join-Path $Work "package\$SetupName")
    Publish-File (Join-Path $Work "portable\$PortableName")
    $materials = Join-Path $Work "bundle\$Program\sbom.cdx.json"
    Copy-Item -LiteralPath $materials -Destination (Join-Path $Dist "$Program-$Version.cdx.json")
}

function Invoke-Build {
    $compiler = Find-MakeNsis $MakeNsis
    $base = Find-Python $Python
    if ($Clean -and (Test-Path -LiteralPath $Work)) {
        Remove-Item -LiteralPath $Work -Recurse -Force
    }
    $release = Read-Native $base.Command ($base.Options + @('-c', 'import sys; print(sys.version)'))
    $venv = { param($folder) Invoke-Native $base.Command ($base.Options + @('-m', 'venv', $folder)) }
    Invoke-Stage 'python' $venv -Fingerprint $release
    $interpreter = Join-Path $Work 'python\Scripts\python.exe'

    $version = Read-Native $interpreter @('-c', 'from installer.layout import version; print(version())')
    $program = Read-Native $interpreter @('-c', 'from installer.layout import PROGRAM; print(PROGRAM)')
    $setup = Read-Native $interpreter @('-c', 'from installer.layout import setup_file; print(setup_file().name)')
    $portable = Read-Native $interpreter @('-c', 'from installer.layout import portable_file; print(portable_file().name)')

    $locked = "$release $((Get-FileHash -Algorithm SHA256 $Lock).Hash)"
    Invoke-Stage 'packages' { param($folder) Install-Lock $interpreter $folder } -Fingerprint $locked
    Invoke-Stage 'pictures' { param($folder) Invoke-Own $interpreter @('installer.pictures', $folder) }
    Invoke-Stage 'manual' { param($folder) Invoke-Own $interpreter @('installer.manual', $folder) }
    Invoke-Stage 'product' { param($folder) Install-Product $interpreter $folder }
    Invoke-Stage 'freeze' { param($folder) Invoke-Freeze $interpreter $version $program $folder }
    Invoke-Stage 'uninstaller' { param($folder) New-Setup $compiler $version (Join-Path $folder 'nothing.exe') }
    Invoke-Stage 'bundle' { param($folder) Complete-Bundle $interpreter $program $folder }
    Invoke-Stage 'portable' { param($folder) New-Portable $interpreter $program (Join-Path $folder $portable) }
    $bundle = @("-DBUNDLE=$(Join-Path $Work "bundle\$program")")
    Invoke-Stage 'package' { param($folder) New-Setup $compiler $version (Join-Path $folder $setup) $bundle }
    Test-Uninstaller
    Publish-Release $version $program $setup $portable
}

Push-Location $Root
try {
    Use-Environment @{ PYTHONPATH = $null; PYTHONHOME = $null; PIP_DISABLE_PIP_VERSION_CHECK = '1' } { Invoke-Build }
}
catch {
    [Console]::Error.WriteLine("build.ps1: $($_.Exception.Message)")
    exit 1
}
finally {
    Pop-Location
}
exit 0
